"""A run, defined tick by tick, with its schedule, draws and metrics. Plants, observers and controllers are arguments.

- `simulate_runs`: the definition; `tick` has the order of events
- `schedule`: when samples are taken and when they arrive
- `rng`, `threefry`: numbers drawn by seed, stream, channel and sample; `measurements`: the noise of samples
- `closed_loop`, `command_network`: from commands to the plant's input
- `metrics`, `innovation_stats`: what is kept of a run; `trajectory`: one run as a table
- `shape_checks`, `law_conformance`: what a user's functions return; `reverse_mode`: loops that have a gradient
- `types`: the numbers of a grid point, and what stays the same for all of them
"""
