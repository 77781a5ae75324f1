"""Reference implementation in NumPy, loops and all: the oracle of the tests, sharing no code with pcbench."""
