"""When samples are taken, when they arrive and how old they are believed to be: clocks and schedules as integers."""
