"""Search over priorities: who is planned before whom, until the whole team has a way."""
