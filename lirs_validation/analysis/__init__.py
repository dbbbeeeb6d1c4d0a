"""Results beside each other: repeats, paired differences, and other programs' results scored."""
