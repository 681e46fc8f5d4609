"""What stands in for the world: arm, gears, friction, industrial controller, camera and force sensor."""
