"""What every room uses: errors that name the cure, files that are whole or not there, the machine."""
