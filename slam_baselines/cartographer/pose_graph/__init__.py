"""The pose graph of submaps and nodes: its constraints, its normal equations, its optimization."""
