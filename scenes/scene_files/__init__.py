"""Scene files: what a person writes of a scene, table by table, checked before anything is played."""
