"""What goes in and what comes out: pulses, echoes, beams, grids, images. All of it is checked where it is made."""
