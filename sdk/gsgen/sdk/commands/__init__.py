"""The gsgen commands that come with the SDK, one module each."""
