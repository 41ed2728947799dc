from .delay import (
    Autoregressive as Autoregressive,
)
from .delay import (
    Delay as Delay,
)
from .delay import (
    DelayError as DelayError,
)
from .delay import (
    Deterministic as Deterministic,
)
from .delay import (
    Empirical as Empirical,
)
from .delay import (
    Gamma as Gamma,
)
from .delay import (
    Gaussian as Gaussian,
)
from .delay import (
    LogNormal as LogNormal,
)
from .delay import (
    Lossy as Lossy,
)
from .delay import (
    Mixture as Mixture,
)
from .delay import (
    OrnsteinUhlenbeck as OrnsteinUhlenbeck,
)
from .delay import (
    OverrunProcess as OverrunProcess,
)
from .delay import (
    RankCorrelation as RankCorrelation,
)
from .delay import (
    RecordedDelays as RecordedDelays,
)
from .delay import (
    Scheduled as Scheduled,
)
from .delay import (
    Stalls as Stalls,
)
from .delay import (
    Uniform as Uniform,
)
from .delay import (
    make_delay as make_delay,
)
from .delay import (
    transport_delay as transport_delay,
)
from .episodes.augmented import (
    AugmentedReplay as AugmentedReplay,
)
from .episodes.augmented import (
    drop_nodes as drop_nodes,
)
from .episodes.augmented import (
    replay_record as replay_record,
)
from .episodes.episode import (
    Episode as Episode,
)
from .episodes.episode import (
    Note as Note,
)
from .episodes.episode import (
    common_part as common_part,
)
from .episodes.episode import (
    record_episodes as record_episodes,
)
from .episodes.episode import (
    replay_episode as replay_episode,
)
from .episodes.storage import (
    EpisodeFileError as EpisodeFileError,
)
from .episodes.storage import (
    EpisodeWriter as EpisodeWriter,
)
from .episodes.storage import (
    RecordedRun as RecordedRun,
)
from .episodes.storage import (
    read_episodes as read_episodes,
)
from .episodes.storage import (
    write_episodes as write_episodes,
)
from .execution.runtime import (
    BatchedRuntime as BatchedRuntime,
)
from .execution.runtime import (
    HorizonError as HorizonError,
)
from .execution.runtime import (
    RuntimeState as RuntimeState,
)
from .live import (
    ConcurrentRuntime as ConcurrentRuntime,
)
from .live import (
    NodeFailure as NodeFailure,
)
from .live import (
    SimulatedRuntime as SimulatedRuntime,
)
from .live import (
    WallClockRuntime as WallClockRuntime,
)
from .model.connection import (
    Connection as Connection,
)
from .model.contract import (
    StepError as StepError,
)
from .model.graph import (
    Graph as Graph,
)
from .model.node import (
    GraphError as GraphError,
)
from .model.node import (
    Input as Input,
)
from .model.node import (
    Node as Node,
)
from .model.node import (
    Supervisor as Supervisor,
)
from .setup import (
    SetupError as SetupError,
)
from .setup import (
    apply_parameters as apply_parameters,
)
from .setup import (
    apply_setup as apply_setup,
)
from .setup import (
    describe_setup as describe_setup,
)
from .setup import (
    read_setup as read_setup,
)
from .setup import (
    write_setup as write_setup,
)
from .timing.computation_graph import (
    ComputationGraph as ComputationGraph,
)
from .timing.draw import (
    TimingError as TimingError,
)
from .timing.draw import (
    draw_timing as draw_timing,
)
from .timing.draw import (
    extend_timing as extend_timing,
)
from .timing.replay import (
    MeasuredTiming as MeasuredTiming,
)
from .timing.replay import (
    replay_timing as replay_timing,
)
