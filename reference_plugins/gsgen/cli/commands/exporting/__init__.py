"""Commands that write and change models, such as export, fix and float16."""
