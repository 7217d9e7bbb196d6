"""From an alarm to a name: refits, sets that cannot be told apart, the verdict."""
