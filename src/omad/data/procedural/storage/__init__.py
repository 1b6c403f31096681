"""Random things that hold other things: furniture with doors and drawers, boxes, bins, jars."""
