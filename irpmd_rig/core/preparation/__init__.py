"""What prepares a rig for measuring: how its instruments answer, and how they stand to each other."""
