"""Run observers on recorded data, with the functions and the order of events of a simulated run."""
