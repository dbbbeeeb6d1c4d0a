"""Controls that viser lacks, and groups of controls."""
