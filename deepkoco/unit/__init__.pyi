from .control import (
    ControlLoop as ControlLoop,
    ControlStats as ControlStats,
)
from .messages import (
    SensorMessage as SensorMessage,
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
    UnitSpec as UnitSpec,
)
from .unit_file import (
    UnitSpecError as UnitSpecError,
    load_unit as load_unit,
    make_unit as make_unit,
)
