"""Gears as springs: stiffness from clamped recordings and payloads, deflection, and an observer of the arm angles."""
