"""From files of one's own camera to an ``Observation``: the points of one object."""
