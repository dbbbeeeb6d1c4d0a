"""ROS bags without ROS: written from a drive and read as logs, through rosbags (extra `[ros]`)."""
