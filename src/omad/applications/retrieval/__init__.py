"""Which object is this, whatever its pose: a catalogue of objects, asked by shape parameters."""
