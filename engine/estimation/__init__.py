"""Parameters by maximum likelihood, and how well they are known."""
