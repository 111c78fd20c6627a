/* A controller in C over UDP: state feedback for the built-in quadrotor, answers each Estimate with a Command.
 *
 *     cc -O2 -o controller controller.c && ./controller 47801
 *
 * The relay of the bench (docs/c.md) sends to that port and takes the answers from it. */

#include "whirlstand.h"

#include <arpa/inet.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/socket.h>

/* u = -K x; states roll, roll rate, pitch, pitch rate in rad and rad/s, inputs u_roll and u_pitch. It stands in for your
 * own law. */
static const double K[2][4] = {{-300.0, -202.0, -90.0, -15.0}, {49.0, 31.0, -321.0, -57.0}};
static const double LIMIT = 20.0;

static void control(const whirlstand_estimate *estimate, whirlstand_command *command) {
    for (int i = 0; i < 2; i++) {
        double u = 0.0;
        for (int j = 0; j < 4; j++) u -= K[i][j] * estimate->x[j];
        command->u[i] = u < -LIMIT ? -LIMIT : u > LIMIT ? LIMIT : u;
    }
    command->count = 2;
}

int main(int count, char **arguments) {
    struct sockaddr_in own = {.sin_family = AF_INET, .sin_port = htons(count > 1 ? atoi(arguments[1]) : 47801)};
    own.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    int port = socket(AF_INET, SOCK_DGRAM, 0);
    if (port < 0 || bind(port, (struct sockaddr *)&own, sizeof own) != 0) {
        perror("cannot listen");
        return 1;
    }
    for (;;) {
        uint8_t bytes[WHIRLSTAND_MAX_BYTES];
        struct sockaddr_in bench;
        socklen_t length = sizeof bench;
        ssize_t got = recvfrom(port, bytes, sizeof bytes, 0, (struct sockaddr *)&bench, &length);
        whirlstand_estimate estimate;
        if (got < 0) {
            perror("cannot receive");
            return 1;
        }
        if (!whirlstand_decode(&whirlstand_estimate_layout, &estimate, bytes, (size_t)got)) continue;

        whirlstand_command command = {.head = estimate.head}; /* an answer is of the same step */
        control(&estimate, &command);
        size_t size = whirlstand_encode(&whirlstand_command_layout, &command, bytes, sizeof bytes);
        sendto(port, bytes, size, 0, (struct sockaddr *)&bench, length);
        if (estimate.head.step % 100 == 0) {
            printf("step %llu  roll %+.5f rad\n", (unsigned long long)estimate.head.step, estimate.x[0]);
            fflush(stdout);
        }
    }
}
