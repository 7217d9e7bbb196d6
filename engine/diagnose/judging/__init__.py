"""From what a search found to a verdict: what speaks against a name, and what is left without one."""
