"""The process: its set-up, memory, caches and progress, and the provenance record of results."""
