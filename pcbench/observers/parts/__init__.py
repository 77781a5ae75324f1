"""What several observers are made of."""
