"""Contact geometry for physics engines: contact grid, prisms, convex parts."""
