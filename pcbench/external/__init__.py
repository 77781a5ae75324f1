"""Observers outside pcbench: export the measurements of runs as files, and import estimates as those of one more observer."""
