"""What a robot perceives besides its laser: odometry, inertial unit, their fusion."""
