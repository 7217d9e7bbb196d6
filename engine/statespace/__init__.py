"""What a model is, and how its functions are called."""
