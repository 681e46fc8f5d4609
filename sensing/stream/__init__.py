"""Stamped fields and wrenches over a socket: the wire format, its bounded parser, and the connection."""
