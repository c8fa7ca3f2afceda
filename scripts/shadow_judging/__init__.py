"""How `scripts/judge_shadows.py` chooses pictures, judges them and keeps what it found."""
