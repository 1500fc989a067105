"""Where f jumps along horizontal and vertical lines, found from its values alone, and what that corrects in a sum over samples."""
