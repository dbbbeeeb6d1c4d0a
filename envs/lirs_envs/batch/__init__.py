"""Many robots at once, each alone in its world: arrays with a row for each."""
