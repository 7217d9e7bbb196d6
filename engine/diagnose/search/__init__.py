"""From an alarm to a name: one effect after another, until nothing is seen."""
