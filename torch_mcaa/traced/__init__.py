"""What f decides, followed through its operations: where its edges are, and what they add to the gradient of a picture."""
