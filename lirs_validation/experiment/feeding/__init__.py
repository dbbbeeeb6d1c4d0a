"""How a drive's mapper gets its scans: at once, in a thread of its own, or in a process of its own."""
