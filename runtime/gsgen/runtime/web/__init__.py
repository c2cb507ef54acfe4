"""How does a web page draw what Python draws? The browser client, pages, and their server."""
