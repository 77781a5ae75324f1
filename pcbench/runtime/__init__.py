"""The process: how it is set up, its memory, its cache, how far its work is, and the record of what made a number."""
