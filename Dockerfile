# A machine for the project: docker build -t pcpc . && docker run --rm pcpc make run
FROM python:3.11-slim-bookworm
RUN apt-get update -qq && apt-get install -y -qq --no-install-recommends make git gcc libc6-dev && \
    rm -rf /var/lib/apt/lists/*
WORKDIR /pcpc
COPY . .
RUN make tools
CMD ["make", "run"]
