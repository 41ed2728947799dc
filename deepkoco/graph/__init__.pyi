from .delay import (
    Autoregressive as Autoregressive,
    Delay as Delay,
    DelayError as DelayError,
    Deterministic as Deterministic,
    Empirical as Empirical,
    Gamma as Gamma,
    Gaussian as Gaussian,
    LogNormal as LogNormal,
    Lossy as Lossy,
    Mixture as Mixture,
    OrnsteinUhlenbeck as OrnsteinUhlenbeck,
    OverrunProcess as OverrunProcess,
    RankCorrelation as RankCorrelation,
    RecordedDelays as RecordedDelays,
    Stalls as Stalls,
    Uniform as Uniform,
    make_delay as make_delay,
)
from .episodes.episode import (
    Episode as Episode,
    Note as Note,
    common_part as common_part,
    record_episodes as record_episodes,
    replay_episode as replay_episode,
)
from .episodes.storage import (
    EpisodeFileError as EpisodeFileError,
    EpisodeWriter as EpisodeWriter,
    RecordedRun as RecordedRun,
    read_episodes as read_episodes,
    write_episodes as write_episodes,
)
from .execution.runtime import (
    BatchedRuntime as BatchedRuntime,
    HorizonError as HorizonError,
    RuntimeState as RuntimeState,
)
from .live import (
    ConcurrentRuntime as ConcurrentRuntime,
    NodeFailure as NodeFailure,
    SimulatedRuntime as SimulatedRuntime,
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
    Input as Input,
    Node as Node,
    Supervisor as Supervisor,
)
from .timing.computation_graph import (
    ComputationGraph as ComputationGraph,
)
from .timing.draw import (
    TimingError as TimingError,
    draw_timing as draw_timing,
    extend_timing as extend_timing,
)
from .timing.replay import (
    MeasuredTiming as MeasuredTiming,
    replay_timing as replay_timing,
)
