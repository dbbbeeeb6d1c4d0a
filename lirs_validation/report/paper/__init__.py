"""The paper's experiment: what was published of it, its tables beside ours, its findings."""
