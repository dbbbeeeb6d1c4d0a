"""Live drives: a ROS 2 system drives and maps in our worlds."""
