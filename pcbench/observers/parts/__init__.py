"""Shared parts of observers."""
