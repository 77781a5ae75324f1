"""One run, tick by tick, for thousands of lanes at once. It takes plants, observers and controllers as arguments."""
