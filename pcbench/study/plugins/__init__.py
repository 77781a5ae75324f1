"""Your own code: plants, observers, controllers and scenarios of a user's files and of installed packages."""
