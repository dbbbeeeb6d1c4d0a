"""Pictures, decoded safely."""
