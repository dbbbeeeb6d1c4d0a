"""Tasks of a robot in an episode: mapping, navigation, traversal of rough ground."""
