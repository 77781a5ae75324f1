"""What suffices? The largest period, delay, loss or noise at which an error stays below a limit, found by asking runs."""
