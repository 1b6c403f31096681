"""Estimates in other people's formats: URDF for simulators, PLY, GLB, ROS messages, Rerun recordings."""
