"""Motion of states: linear maps, their discretisation, integration of vector fields, observability."""
