"""The door for programs: tools of the Model Context Protocol, a policy, an audit."""
