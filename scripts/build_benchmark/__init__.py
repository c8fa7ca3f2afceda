"""How long builds take and what they hold: processes, changed models, rounds, the report."""
