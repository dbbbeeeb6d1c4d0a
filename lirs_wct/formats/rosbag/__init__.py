"""ROS bags without ROS: a drive is written as a ROS 2 bag through rosbags (extra `[ros]`)."""
