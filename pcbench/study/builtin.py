"""The built-in studies, by name."""

from math import inf, sqrt

from pcbench.scenarios import SCENARIOS
from pcbench.study.scenario_schema import ScenarioTable
from pcbench.study.schema import TUNINGS, Study, Tune
from pcbench.toml_text import TomlTable

QUESTIONS = {  # of each study, as a question
    "quick": "Which observer of the cart has the least error, without and with noise?",
    "cart": "Which observer is best in each scenario of the cart?",
    "unequal-delays": "How much does it help to use the delay of each sensor?",
    "unknown-input": "How well are unknown inputs estimated over period, delay, noise and drift?",
    "helicopter": "When does a high-gain observer fail, but not an extended Kalman filter?",
    "equal-tuning": "Which observer is best if all are tuned with the same effort?",
    "model-mismatch": "How much error does each wrong assumption cost?",
    "delayed-measurements": "Which method for delayed measurements is best at each delay?",
    "measurement-errors": "How much of each measurement error does an observer tolerate?",
    "reactor": "Which nonlinear filter recovers from a wrong initial state?",
    "equal-tuning-reactor": "Do tuned filters match an estimator with bounds?",
    "period-delay-map": "Which sampling period and delay keep the error small?",
    "growth-model": "How much better is a particle filter than an EKF on the growth model?",
    "ncs-two-state": "Up to which period does held state feedback settle?",
    "ncs-reactor": "How often must a network transmit, by round robin or try-once-discard?",
    "intermittent": "How does the error grow near the critical loss?",
    "quadruple-tank": "How much error does a delayed level cost?",
    "flexible-joint": "Up to which period do observers follow the joint?",
    "falling-body": "How much does an unscented filter gain over an EKF on a falling body?",
    "coordinated-turn": "Which filter follows a turning target, and at which delay?",
    "digester": "How long may laboratory measurements be delayed?",
    "camera-target": "How much better is a filter for a delayed camera than visual servoing?",
    "outage": "How far does the error grow during an outage?",
    "send-on-delta": "How does the error depend on the number of messages (send on delta)?",
    "processor": "On which processor is a particle filter worse than a Kalman filter?",
    "all": "Which observer is best in each built-in scenario?",
    "variable-sampling": "How much do a variable period, jitter and loss cost?",
}
PERIODS = (0.5, 1.0, 1.5, 1.7, 1.8)  # s: the loop of `ncs-two-state` is stable below 1.72941
INTERVALS = (0.01, 0.05, 0.1, 0.2)  # s between two transmissions of `ncs-reactor`
SERVO_GAINS = (2.0, 4.0, 8.0)  # 1/s, of the visual servos of `camera-target`
# observers of the literature for samples with a constant delay
LITERATURE = ("eso", "cascade-predictor", "super-twisting", "finite-time", "high-gain-predictor", "lmi-sampled")
WANDER = (0.01, 0.1)  # m, m/s per tick: the process noise of `model-mismatch`
# the wrong assumption of each scenario; noise sizes are wrong by a factor of 4
WRONG_ASSUMPTIONS: dict[str, TomlTable] = {
    "as-assumed": {},
    "noise-over": {"assumed_process_std": [std / 4 for std in WANDER]},  # a gain depends on the ratio of R and Q only
    "noise-under": {"assumed_process_std": [std * 4 for std in WANDER]},
    "delay-over": {"assumed_delay_error": 0.04},
    "delay-under": {"assumed_delay_error": -0.04},
    "gain-off": {"parameters": {"b": 390.5}},
    "parameter_drift": {"parameter_drift": 1.0},
}


def _mismatch_scenario(name: str) -> ScenarioTable:
    """Return one scenario of `model-mismatch`: cart/white with a drifting position and one wrong assumption."""
    ratio = {"noise-over": 16.0, "noise-under": 1 / 16}.get(name, 1.0)
    options = {
        # the usual treatment of an uncertain model: noise on the input
        "pccebo-loose": {"gain": "riccati", "q": 0.1 / ratio},
        "pccebo-riccati": {"gain": "riccati", "q": 0.002 / ratio},
        "pco": {"Kp": -61.0},
        "pi-pco": {"Kp": -61.0, "Ki": 12.2},
        "kfbo": {"R": 0.07 * ratio, "Q": [0.1, 10.0]},  # intensities: 0.35 per sample times 0.2 s, and WANDER
    }
    defaults = {"base": "cart/white", "process_std": list(WANDER), "drift_intensity": 0.0, "options": options}
    return ScenarioTable.model_validate(defaults | WRONG_ASSUMPTIONS[name])


def _state_feedback(period: float) -> ScenarioTable:
    """Return a scenario of `ncs-two-state` with one period [s] for samples and commands."""
    control = {**SCENARIOS["ncs-two-state/held"].loop.control, "period": period}
    table = {"base": "ncs-two-state/held", "sampling_period": period, "control": control}
    return ScenarioTable.model_validate(table)


def _round_robin(interval: float) -> ScenarioTable:
    """Return a scenario of `ncs-reactor`: the outputs are sent in turn, one every `interval` [s]."""
    table = {"base": "ncs-reactor/round-robin", "sampling_period": 2 * interval, "sampling_phase": [0.0, interval]}
    return ScenarioTable.model_validate(table)


def _try_once_discard(interval: float) -> ScenarioTable:
    """Return a scenario of `ncs-reactor`: every `interval` [s] the output with the largest change is sent."""
    table = {"base": "ncs-reactor/round-robin", "sampling_period": interval, "sampling_phase": 0.0}
    return ScenarioTable.model_validate(table | {"try_once_discard": 1})


PROTOCOLS = {"round-robin": _round_robin, "try-once-discard": _try_once_discard}


def _visual_servo(gain: float) -> ScenarioTable:
    """Return a scenario of `camera-target`: the velocity is `gain` [1/s] times the estimated offset."""
    table = {"base": "camera-target/servoing", "control": {"K": [[-gain, 0.0, 0.0]]}}
    return ScenarioTable.model_validate(table)


STUDIES = {
    "quick": Study(name="quick", scenarios=["cart/nominal", "cart/white"], seeds=256),
    "cart": Study(
        name="cart",
        scenarios=[name for name, s in SCENARIOS.items() if s.plant == "cart" and not name.startswith("cart/variable")],
        seeds=1024,
    ),
    "unequal-delays": Study(
        name="unequal-delays",
        scenarios=["csth/10s-noise"],
        observers=["chain", "chain-slow", "chain-riccati", "equal-delay", "no-delay", "kf", "model-only"],
        seeds=256,
        axes={
            "delay": [
                [40.0, 40.0, 40.0],
                [30.0, 40.0, 50.0],
                [20.0, 40.0, 60.0],
                [10.0, 40.0, 70.0],
                [20.0, 50.0, 70.0],
            ],
            "noise_std": [[1.0, 0.1, 0.1], [0.1, 0.01, 0.01]],
        },
    ),
    "unknown-input": Study(
        name="unknown-input",
        scenarios=["arm/sampled"],
        seeds=256,
        axes={
            "sampling_period": [0.001, 0.02, 0.2],
            "delay": [0.001, 0.02, 0.2],
            "noise_std": [1e-3, 3e-3],
            "parameter_drift": [0.0, 0.01, 0.05],
        },
    ),
    "helicopter": Study(
        name="helicopter",
        scenarios=["helicopter/constant"],
        observers=["high-gain", "high-gain-robust", "ekf"],
        seeds=256,
        axes={
            "sampling_period": [0.05, 0.2, 0.8],
            "delay": [0.01, 0.03],
            "noise_std": [5e-4, 2e-2],
            "parameter_drift": [0.0, 0.3],
        },
        options={"scenario": {"random_initial_state": True}},
    ),
    "equal-tuning": Study(
        name="equal-tuning",
        scenarios=["cart/gaussian"],
        seeds=1024,
        options={"scenario": {"random_initial_state": True}},
        tuning=list(TUNINGS),
        tune=Tune(objective="steady_pooled_rmse", exact_objective=True),  # the same gains in less time than by runs
    ),
    "model-mismatch": Study(
        name="model-mismatch",
        scenarios=list(WRONG_ASSUMPTIONS),
        tables={name: _mismatch_scenario(name) for name in WRONG_ASSUMPTIONS},
        observers=["kf", "pccebo-riccati", "pccebo-loose", "pco", "pi-pco", "kfbo", *LITERATURE, "model-only"],
        seeds=256,
        options={"scenario": {"random_initial_state": True, "consistency": True}},
    ),
    "delayed-measurements": Study(  # for a constant delay all others of the family equal kf
        name="delayed-measurements",
        scenarios=["cart/gaussian"],
        observers=[
            "kf",
            "kf-ignore-delay",
            "kf-shifted-innovation",
            "kf-drop-delayed",
            "kf-larsen",
            "kf-alexander",
            *LITERATURE,
            "model-only",
        ],
        seeds=256,
        axes={"delay": [0.0, 0.1, 0.2, 0.4, 0.8], "noise_std": [0.5], "process_std": [[0.02, 0.0]]},
        options={"scenario": {"random_initial_state": True, "consistency": True}},
    ),
    "measurement-errors": Study(
        name="measurement-errors",
        scenarios=["cart/gaussian"],
        observers=["kf", "kf-gate", "kf-huber", "pccebo", "model-only"],
        seeds=256,
        vary="one-at-a-time",
        axes={
            "outlier_probability": [0.0, 0.01, 0.05, 0.2],
            "noise_std": [0.5],
            "process_std": [[0.02, 0.0]],
            "student_t_dof": [inf, 4.0, 2.5],
            "assumed_noise_scale": [1.0, 0.25, 0.5, 2.0, 4.0],
            "quantization_step": [0.0, 1.0, 5.0, 20.0],
            "loss": [0.0, 0.5, 0.9, 0.98],
            "delay_gamma_mean": [0.0, 0.2, 0.8, 3.2],
            "timestamp_offset": [0.0, -0.1, -0.4, -1.6],
            "clock_skew": [0.0, -1000.0, -10_000.0, -100_000.0],
            "timestamp_jitter": [0.0, 0.03, 0.09],
        },
        options={
            "scenario": {"random_initial_state": True, "consistency": True},
            "kf-gate": {"gate": 3.0},
            "kf-huber": {"huber": 1.5},
        },
    ),
    "reactor": Study(name="reactor", scenarios=["reactor/batch"], seeds=256),
    "equal-tuning-reactor": Study(
        name="equal-tuning-reactor",
        scenarios=["reactor/batch"],
        observers=["ekf", "ukf", "mhe-bounded"],
        seeds=256,
        options={"mhe-bounded": {"window": 4, "iterations": 1}},  # as accurate here, at a quarter of the cost
        tuning=["published", "tuned"],
        tune=Tune(objective="steady_rmse", only=["Q"], budget=40, training=128),
    ),
    "period-delay-map": Study(  # 20 x 20 grid points, without seeds
        name="period-delay-map",
        scenarios=["cart/gaussian"],
        observers=["pccebo", "kfbo", "kf"],
        evaluation="exact",
        axes={
            "sampling_period": [round(0.02 * i, 2) for i in range(1, 21)],
            "delay": [round(0.02 * i, 2) for i in range(20)],
        },
    ),
    "growth-model": Study(  # x(0) from N(0, 5); independent results are in the scenario's module
        name="growth-model",
        scenarios=["gordon"],
        tables={"gordon": ScenarioTable.model_validate({"base": "growth-model/gordon", "prior_std": [sqrt(5.0)]})},
        seeds=400,
        options={"scenario": {"random_initial_state": True, "consistency": True}},
    ),
    "ncs-two-state": Study(
        name="ncs-two-state",
        scenarios=[f"period-{period:g}" for period in PERIODS],
        tables={f"period-{period:g}": _state_feedback(period) for period in PERIODS},
        observers=["kf"],
        seeds=256,
    ),
    "ncs-reactor": Study(
        name="ncs-reactor",
        scenarios=[f"{name}-{interval:g}" for name in PROTOCOLS for interval in INTERVALS],
        tables={f"{name}-{interval:g}": make(interval) for name, make in PROTOCOLS.items() for interval in INTERVALS},
        seeds=64,
    ),
    "intermittent": Study(  # critical loss: 0.64
        name="intermittent",
        scenarios=["intermittent/scalar"],
        seeds=1024,
        axes={"loss": [0.1, 0.2, 0.4, 0.5, 0.6, 0.63]},
        options={"scenario": {"random_initial_state": True}},
    ),
    "quadruple-tank": Study(
        name="quadruple-tank",
        scenarios=["quadruple-tank/delayed", "quadruple-tank/right-zero"],
        seeds=256,
        axes={"delay": [[0.0, 0.0], [0.0, 30.0], [0.0, 60.0], [0.0, 120.0]]},
        options={"scenario": {"random_initial_state": True, "consistency": True}},
    ),
    "flexible-joint": Study(
        name="flexible-joint",
        scenarios=["flexible-joint/sampled"],
        observers=["ekf", "lmi-sampled", "kf", "model-only"],
        seeds=256,
        axes={"sampling_period": [0.05, 0.1, 0.2, 0.4, 0.5]},
        options={
            "scenario": {"random_initial_state": True, "consistency": True},
            # one gain for all periods, certified for intervals up to 0.28 s
            "lmi-sampled": {"max_interval": 0.28, "parameter_range": {"gravity": [-3.33, 3.33]}},
        },
    ),
    "falling-body": Study(
        name="falling-body", scenarios=["falling-body/radar"], seeds=400, axes={"delay": [0.0, 0.5, 1.0, 2.0]}
    ),
    "coordinated-turn": Study(
        name="coordinated-turn",
        scenarios=["coordinated-turn/radar"],
        seeds=250,
        axes={"delay": [0.0, 1.0, 2.0, 4.0]},
        options={"scenario": {"random_initial_state": True, "consistency": True}},
    ),
    "digester": Study(
        name="digester",
        scenarios=["digester/multirate"],
        observers=["ekf", "kf", "kf-larsen", "kf-shifted-innovation", "kf-ignore-delay", "model-only"],
        seeds=32,
        axes={"delay": [[0.0] * 3 + [3600.0 * hours] * 3 for hours in (0, 7, 14, 21)]},
    ),
    "camera-target": Study(
        name="camera-target",
        scenarios=["following", *(f"servo-{gain:g}" for gain in SERVO_GAINS)],
        tables={"following": ScenarioTable(base="camera-target/following")}
        | {f"servo-{gain:g}": _visual_servo(gain) for gain in SERVO_GAINS},
        seeds=64,
        axes={"delay": [[delay, 0.0] for delay in (0.0, 0.1, 0.2, 0.3)]},
        options={"scenario": {"random_initial_state": True, "consistency": True}},
    ),
    "outage": Study(  # the error grows by a factor of 1.25 per step
        name="outage",
        scenarios=["interrupted"],
        tables={
            "interrupted": ScenarioTable.model_validate(
                {"base": "intermittent/scalar", "loss": 0.0, "duration": 40.0, "steady_start": 20.0}
            )
        },
        seeds=1024,
        axes={"outage_start": [25.0], "outage_duration": [0.0, 3.0, 6.0, 9.0]},
        options={"scenario": {"random_initial_state": True}},
    ),
    "send-on-delta": Study(
        name="send-on-delta",
        scenarios=["levels"],
        tables={"levels": ScenarioTable.model_validate({"base": "quadruple-tank/delayed", "delay": [0.0, 0.0]})},
        observers=["kf", "kf-event", "model-only"],
        seeds=256,
        axes={"send_threshold": [0.0, 0.05, 0.1, 0.2, 0.4, 0.8]},
        options={"scenario": {"random_initial_state": True, "consistency": True}},
    ),
    "processor": Study(
        name="processor",
        scenarios=["double-well/sampled"],
        seeds=128,
        axes={"processor_speed": [5e3, 1e4, 2e4, 5e4, 2e5, 3e5, 4e5, 5e5, 7e5, 1e6, 2e6, inf]},
        options={"scenario": {"random_initial_state": True, "consistency": True}},
    ),
    "all": Study(name="all", scenarios=list(SCENARIOS), seeds=256),
    "variable-sampling": Study(
        name="variable-sampling",
        scenarios=["cart/variable", "cart/variable-bias", "cart/variable-gain"],
        seeds=256,
        axes={"sampling_pattern": ["sine", "uniform"], "sampling_jitter": [0.0, 0.04], "loss": [0.0, 0.2]},
    ),
}
