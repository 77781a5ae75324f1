"""Between two events of an affine cell, several ticks of all lanes as one product with numbers that lanes have in common."""
