"""Live topics: a ROS 2 system drives and maps in our worlds, without a ROS installation here."""
