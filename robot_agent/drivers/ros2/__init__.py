"""Driver of robots that listen and report on ROS 2 topics, through the rclpy of the lab."""
