"""Loop-closure constraints: candidates, search, verification."""
