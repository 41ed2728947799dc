"""Studies and benchmarks, run from a checkout. Commands of recorded results work under the names that they had."""

from deepkoco.old_names import find_moved

MOVED = (
    (
        "experiments",
        "experiments.benchmarks",
        "agents_benchmark agent_work diagnose_benchmark fit_benchmark graph_benchmark "
        "planner_benchmark planner_costs training_benchmark rollout_speed rollout_work "
        "single_environment peers identify_peer large_graph supergraph_efficiency "
        "supergraph_efficiency_table topologies",
    ),
    (
        "experiments",
        "experiments.studies.diagnosis",
        "hidden hidden_effects hidden_results design_study fuzz_logs log_faults gallery real_logs "
        "real_log_studies identify_pendulum closing_the_loop",
    ),
    (
        "experiments",
        "experiments.studies.learning",
        "ablations ablation_differences bisimulation_sanity comparison delay_training difficulty "
        "difficulty_figure domain_randomization figures optimum reference_costs sac_comparison "
        "sac_on_unit collect_runs tuning tuning_report search_space aborted_sweeps",
    ),
    (
        "experiments",
        "experiments.studies.graph",
        "asynchronous_drift live_study real_delays real_delays_report real_time_factor wall_clock_timing",
    ),
)
find_moved(MOVED)
