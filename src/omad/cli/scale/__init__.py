"""Commands for more than a person waits for: a million images, a service."""
