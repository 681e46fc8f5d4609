"""The simulated arm: links, motors, gears, friction, controller."""
