"""The rig: a UR robot, a load cell and an EIT board become a recording."""
