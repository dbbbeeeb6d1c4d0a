"""Moving obstacles: walkers on seeded paths, that the lidar sees and the robot touches."""
