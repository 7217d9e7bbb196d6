"""The HTTP service: a thin shell around the engine."""
