"""A ROS 2 node around OMAD: depth image, camera and mask in, joint states, transforms and markers out."""
