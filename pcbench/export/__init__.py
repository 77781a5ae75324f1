"""Export of an observer as C code with its gains, and a run to test the code.

- `files`: the files of `pcbench.export`; `c_files`: header and source; `numbers`: gains as JSON and MAT
- `observer_to_c`: an observer's functions; `jaxpr_to_c`: a traced function; `terms`, `arithmetic`, `places`: its expressions
- `c_replay`, `recording`, `structs`: the run that tests the C code
"""
