"""A platform that follows a target seen by a late camera: the error reduction that the abstract of the paper states.

The abstract was seen. The text was not obtained, nor the period and latency of its camera, the motion of its target and the
servo that it compares with. So the reduction is computed for the numbers of `camera-target`, and the claim is not determinable.
"""

from pcbench import api
from pcbench.papers.claim import OPEN, Claim
from pcbench.toml_text import TomlTable

SEEDS = 64
REGULAR: TomlTable = {
    "model": {"damping": 0.01},
    "process_std": [0.001, 0.0, 0.025],
}  # a motion that is easier to predict
LAWS: dict[str, TomlTable] = {
    "following": {"base": "camera-target/following", "observers": ["kf"]},
    "servoing": {"base": "camera-target/servoing", "observers": ["kf-ignore-delay"]},
}


def rows() -> list[Claim]:
    """Return the claim of the abstract; takes half a minute."""
    study: TomlTable = {
        "name": "camera-target-claims",
        "scenarios": {**LAWS, **{f"{name}-regular": law | REGULAR for name, law in LAWS.items()}},
        "seeds": SEEDS,
        "options": {"scenario": {"random_initial_state": True}},
    }
    stats = api.run(study).stats
    tracking_rows = stats[(stats.metric == "steady_tracking_rmse") & (stats.signal == "offset")]
    error = tracking_rows.set_index("scenario")["mean"]
    usual, regular = (100 * (1 - error[f"following{kind}"] / error[f"servoing{kind}"]) for kind in ("", "-regular"))
    text = (
        f"{usual:.0f} % in camera-target/following against camera-target/servoing, and {regular:.0f} % for a target with a "
        "tenth of the damping and of the noise power; camera, target and servo of the paper are not known"
    )
    claim = "reduction of the tracking error by a dual-rate filter with late data, against common visual servoing"
    return [Claim(claim, "95 %", text, OPEN, source="Xiao, Chen 2020 [S]")]
