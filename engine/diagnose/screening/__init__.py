"""Every effect tested at once, from the filter of the model as it is."""
