"""A small study that asks who knows how wrong it is: two states under one late sensor, pushed by noise."""

STUDY = {
    "name": "honest",
    "observers": ["kf", "kf-bold", "model-only"],
    "seeds": 32,
    "lti": {
        "A": [[0.0, 1.0], [-0.6, -0.4]], "B": [[0.0], [1.0]], "C": [[1.0, 0.0]], "x0": [0.4, 0.0], "xhat0": [0.0, 0.1],
        "prior_std": [1.0, 0.7], "tick": 0.1, "duration": 6.0, "steady_start": 2.0, "noise_std": [0.3], "sampling_period": 0.5,
        "delay": 0.3, "states": ["a", "b"], "process_std": [0.02, 0.1],
    },
    "options": {"scenario": {"random_initial_state": True, "consistency": True}, "kf-bold": {"R": 0.0225}},
}  # fmt: skip  # kf-bold is told a quarter of the variance
