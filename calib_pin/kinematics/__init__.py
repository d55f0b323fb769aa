"""Geometry of a robot: transforms, chains of joints, bodies that must not collide."""
