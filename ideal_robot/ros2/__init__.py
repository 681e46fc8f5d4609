"""An arm, a camera and a force sensor behind ROS 2: topics over DDS, by rclpy."""
