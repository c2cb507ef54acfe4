"""Which statements about an ONNX generator does the validator check? One module per subject."""
