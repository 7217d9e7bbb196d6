"""How long a model's steps may be, and what they get wrong."""
