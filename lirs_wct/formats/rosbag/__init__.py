"""ROS bags without ROS: writing drives, reading logs."""
