"""Where f jumps: on lines, from its values alone or by the decisions it takes; what that corrects in values, and adds to gradients."""
