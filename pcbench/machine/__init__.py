"""The process and its machine: how it is set up, its memory, its cache, and the record of what made a number."""
