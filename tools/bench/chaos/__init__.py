"""`tagmill bench chaos`: recordings while everything goes wrong, and a judge who trusts nobody."""
