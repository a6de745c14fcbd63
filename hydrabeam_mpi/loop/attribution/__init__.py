"""What the residual comes from: the evidence for every effect and for changes of the weights."""
