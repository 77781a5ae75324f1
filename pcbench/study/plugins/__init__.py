"""Plugins: user-defined plants, observers, controllers and scenarios from files and installed packages."""
