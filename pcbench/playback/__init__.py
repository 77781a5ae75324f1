"""Observers on recorded data: what was measured, when it arrived, through the functions and the order of a simulated run."""
