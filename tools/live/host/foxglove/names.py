"""Names that the server and its layouts share."""

LOG_TOPIC = "/log"
TOKEN = "write.token"
