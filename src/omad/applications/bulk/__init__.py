"""A million images: estimates as a stream in bounded memory, and files of them that go on where they stopped."""
