"""Forward in time: what is known of the states from the readings so far."""
