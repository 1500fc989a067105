"""The backward pass of the layer: points evaluated again, block by block, with the adjoint of the filter's weights as their coefficients."""
