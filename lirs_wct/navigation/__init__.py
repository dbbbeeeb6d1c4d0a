"""Where a robot can be: traversability and spawn poses."""
