"""What a study chose, for a program of one's own: an observer as C, with its gains, and a run to test it by."""
