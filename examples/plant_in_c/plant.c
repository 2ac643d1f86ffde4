/* A lift behind JSON lines over UDP, sample by sample: what a simulator of your own does to be tested.

   cc -O2 plant.c -lm -o plant && ./plant 5005 */
#include <arpa/inet.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

static const double STEP_S = 0.01, LAG_S = 0.08, TRAVEL_MM = 250.0;
static const double ONSET_A[2] = {0.35, 0.25}, GAIN[2] = {90.0, -70.0}; /* A; mm/(s*A), lifting and lowering */

int main(int count, char **arguments) {
  struct sockaddr_in bench = {.sin_family = AF_INET, .sin_port = htons(count > 1 ? atoi(arguments[1]) : 5005)};
  struct timespec next;
  double at_mm = 40.0, speed = 0.0, command[2] = {0.0, 0.0};
  char line[256];
  int link = socket(AF_INET, SOCK_DGRAM, 0);
  bench.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  connect(link, (struct sockaddr *)&bench, sizeof bench);
  clock_gettime(CLOCK_MONOTONIC, &next);
  for (long sample = 0;; sample++) {
    int size = snprintf(line, sizeof line, "{\"time_s\": %.2f, \"displacement\": %.3f}\n", sample * STEP_S, at_mm);
    send(link, line, size, 0); /* nobody listens yet: tried again with the next sample */
    for (ssize_t got; (got = recv(link, line, sizeof line - 1, MSG_DONTWAIT)) > 0;) {
      line[got] = '\0'; /* {"lifting_command": 0.5, "lowering_command": 0.0} */
      sscanf(line, "{\"lifting_command\": %lf, \"lowering_command\": %lf", &command[0], &command[1]);
    }
    double wanted = 0.0; /* mm/s: each valve beyond its dead zone, a lag behind it, stops at both ends */
    for (int way = 0; way < 2; way++) wanted += GAIN[way] * fmax(command[way] - ONSET_A[way], 0.0);
    speed += (wanted - speed) * (1.0 - exp(-STEP_S / LAG_S));
    at_mm = fmin(fmax(at_mm + speed * STEP_S, 0.0), TRAVEL_MM);
    next.tv_nsec += (long)(1e9 * STEP_S);
    if (next.tv_nsec >= 1000000000L) next.tv_nsec -= 1000000000L, next.tv_sec++;
    clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &next, NULL);
  }
}
