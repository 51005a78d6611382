"""Everything that a user starts: launch files, arms, calibrations of the 1985 rig, and the program ``bringup``."""
