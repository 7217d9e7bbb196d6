"""Backward in time: what is known of the states from the whole record."""
