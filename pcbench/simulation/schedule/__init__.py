"""The ticks at which samples are taken and arrive, and their assumed age. All times are whole ticks.

A sample arrives at the tick at which it is taken plus its delay. `planning.build` chooses between common and random schedules:

- `sampling`: the definition of a clock and its intervals
- `common_times`: one schedule for all runs; `plain_clock` is vectorized, `samples` and `schedule` cover any clocks
- `random_times`: one schedule per run, drawn by its seed (`clock_times`)
- `event_table`: the samples and arrivals of all runs in order of time
"""
