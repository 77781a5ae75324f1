"""How a state moves: linear maps, their discretisation, integration of vector fields, observability."""
