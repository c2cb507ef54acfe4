"""Where does an input come from: a web server, the Hugging Face Hub, an object store, an archive?"""
