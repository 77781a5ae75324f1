"""A run, defined tick by tick, with its schedule, draws and metrics. Plants, observers and controllers are arguments."""
