"""The other ends of interfaces to real devices."""
