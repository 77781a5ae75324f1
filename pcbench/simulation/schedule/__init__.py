"""When samples are taken, when they arrive and how old observers assume them to be: everything in whole ticks.

A sample arrives at the tick at which it is taken plus its delay. `planning.build` chooses who computes this:

- `sampling`: what a clock is; the intervals between its samples
- `common_times`: a schedule that all runs share; `plain_clock` at once, `samples` and `schedule` for any other clocks
- `random_times`: a schedule for each run, drawn by its seed (`clock_times`)
- `event_table`: the drawn samples and arrivals of all runs in order of time
"""
