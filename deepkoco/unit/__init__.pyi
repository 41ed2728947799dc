from .control import (
    ControlLoop as ControlLoop,
)
from .control import (
    ControlStats as ControlStats,
)
from .messages import (
    SensorMessage as SensorMessage,
)
from .messages import (
    UnitError as UnitError,
)
from .process import (
    Unit as Unit,
)
from .simulated import (
    SimulatedUnit as SimulatedUnit,
)
from .spec import (
    SensorSpec as SensorSpec,
)
from .spec import (
    UnitSpec as UnitSpec,
)
from .unit_file import (
    UnitSpecError as UnitSpecError,
)
from .unit_file import (
    load_unit as load_unit,
)
from .unit_file import (
    make_unit as make_unit,
)
