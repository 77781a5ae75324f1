"""The studies that pcbench brings along, by name."""

from pcbench.scenarios import SCENARIOS
from pcbench.study.schema import TUNINGS, Study, Tune

STUDIES = {
    "quick": Study(name="quick", scenarios=["cart/nominal", "cart/white"], seeds=256),
    "cart": Study(
        name="cart",
        scenarios=[s for s in SCENARIOS if s.startswith("cart/") and not s.startswith("cart/variable")],
        seeds=1024,
    ),
    "unequal-delays": Study(
        name="unequal-delays",
        scenarios=["csth/10s-noise"],
        observers=["chain", "chain-slow", "chain-riccati", "equal-delay", "no-delay", "dkf", "open-loop"],
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
            "drift": [0.0, 0.01, 0.05],
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
            "drift": [0.0, 0.3],
        },
        options={"scenario": {"random_start": True}},
    ),
    "fair": Study(
        name="fair",
        scenarios=["cart/gaussian"],
        seeds=1024,
        options={"scenario": {"random_start": True}},
        tuning=list(TUNINGS),
        tune=Tune(objective="tail_pooled_rmse"),
    ),
    "all": Study(name="all", scenarios=list(SCENARIOS), seeds=256),
    "variable-sampling": Study(
        name="variable-sampling",
        scenarios=["cart/variable", "cart/variable-bias", "cart/variable-gain"],
        seeds=256,
        axes={"profile": ["sine", "uniform"], "jitter": [0.0, 0.04], "loss": [0.0, 0.2]},
    ),
}
