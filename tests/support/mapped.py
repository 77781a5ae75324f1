"""A process that makes many programs, and prints how many memory mappings it has at the end."""

import sys

import pcbench
from pcbench.runtime import config

STUDY = {
    "name": "many",
    "lti": {"A": [[-1.0]], "B": [[1.0]], "C": [[1.0]], "sampling_period": 0.1, "delay": 0.1, "noise_std": 0.1},
    "observers": ["kf"],
    "seeds": 2,
}


def main(programs):
    """Run and trace studies of other horizons, each of which is a program of its own."""
    config.setup()
    for i in range(programs):
        lti = STUDY["lti"] | {"tick": 0.05, "duration": 1.0 + 0.05 * i}
        pcbench.run(STUDY | {"lti": lti})
        pcbench.simulate(STUDY | {"lti": lti}, "kf")
    with open("/proc/self/maps") as maps:
        print(sum(1 for _ in maps))


if __name__ == "__main__":
    main(int(sys.argv[1]))
