"""What a robot is to do in an episode: map, reach a goal, cross rough ground."""
