"""What a physics engine touches: contact grid, prisms, convex parts."""
